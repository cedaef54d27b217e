"""The chain from a log to a bound: its links, checked one by one."""
