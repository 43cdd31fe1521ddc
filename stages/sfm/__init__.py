"""Structure from motion: the steps that the child process `stages.sfm.child` takes, each kept when it is finished.

photos -> copies, database (features, then matches) -> model/ -> result.json, all in one folder.
"""
