"""The pipeline: one module a stage; joins what is on disk (schemas) with the mathematics (stylerf)."""
