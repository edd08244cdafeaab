"""The page of a study: figures, tables, answers, and where each number comes from."""
