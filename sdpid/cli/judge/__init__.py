"""Commands that judge what was made elsewhere: descriptions, tables, parameters."""
