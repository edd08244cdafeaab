"""What scores amount to: statistics with intervals, bins, recall, consistency, comparisons, tables."""
