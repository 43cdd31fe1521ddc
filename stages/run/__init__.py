"""Running a stage: runner, clock, memory, device, checkpoints, progress."""
