"""What scores amount to: statistics with intervals, recall, consistency, comparisons, tables."""
