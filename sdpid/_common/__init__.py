"""Helpers that every room may use: arrays, files, tables, threads, the sandbox."""
