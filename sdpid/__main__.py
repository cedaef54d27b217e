"""``python -m sdpid`` is the command ``sdpid``."""

from sdpid.cli import main

if __name__ == "__main__":
    main()
