"""The definition of the pipeline: the table of stages, their functions, and the pairs of cameras."""
