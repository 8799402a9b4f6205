"""How good a night is: its figures, what is usual, and the rules that judge it."""
