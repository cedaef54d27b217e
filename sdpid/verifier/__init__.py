"""Check proofs in exact arithmetic: ``python sdpid/verifier FILE_OR_FOLDER``.

This folder needs Python 3.10 and nothing else, may be copied anywhere, and trusts no solver. Every
number in a file is the IEEE double (or the fraction) that its digits denote; from there on nothing
is rounded.
"""
