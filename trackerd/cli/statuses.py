"""Exit statuses of every command; argparse itself ends with 2."""

DONE, BUG, WRONG_INPUT, REFUSED, TO_MEND = 0, 1, 2, 3, 4
