"""What is to be done: the table of stages, their functions, and the pairs of cameras."""
