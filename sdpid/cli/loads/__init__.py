"""Commands about what an arm carries: payloads, and gains from a known load."""
