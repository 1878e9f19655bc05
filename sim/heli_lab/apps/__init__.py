"""Users of the laboratory: classroom, the paper, campaigns, many rigs, Gymnasium."""
