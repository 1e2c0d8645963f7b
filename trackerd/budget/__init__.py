"""What limits a cell: the source thesis's Monte-Carlo beside bundle adjustment and Cramér-Rao bound; each cause's share."""
