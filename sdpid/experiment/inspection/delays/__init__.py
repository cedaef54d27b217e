"""How late channels of a recording with a base are against its joints' positions."""
