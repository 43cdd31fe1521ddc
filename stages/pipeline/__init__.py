"""The pipeline: a work folder, what must exist before a stage runs, and whole chains of stages.

Use `stages.pipeline.pipeline.Pipeline` from Python.
"""
