"""The pipeline: work folder, prerequisites of each stage, local edits as one job, several processes."""
