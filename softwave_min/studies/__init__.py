"""What judges many parameter sets: search, sensitivity, other readings of the paper."""
