"""Tables of parameters as CSV, JSON and YAML."""
