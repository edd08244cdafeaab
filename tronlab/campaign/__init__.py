"""A campaign YAML, its immutable shots, and the engine that runs them."""
