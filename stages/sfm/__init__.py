"""Structure from motion: the steps of the child process `stages.sfm.child`, each saved when finished.

photos -> copies, database (features, then matches) -> model/ -> result.json, all in one folder.
"""
