"""The command line: ``python -m softwave_min``.

Processes that compute import this module anew, and need nothing of it.
"""

if __name__ == "__main__":
    import sys

    from softwave_min.command_line import main

    sys.exit(main())
