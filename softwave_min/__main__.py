"""The command line: ``python -m softwave_min``.

Processes that compute import this module anew, and need nothing of it.
"""

if __name__ == "__main__":
    import sys

    from softwave_min.data import in_project

    if not in_project():
        sys.stderr.write("the experiments need the project's folder, with its data and results\n")
        sys.exit(2)

    from softwave_min.command_line import main

    sys.exit(main())
