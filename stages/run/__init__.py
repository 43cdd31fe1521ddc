"""Running a stage: the runner, its clock, memory, devices, checkpoints and progress."""
