"""Why to believe it: certificates and validation."""
