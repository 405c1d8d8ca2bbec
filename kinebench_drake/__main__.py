"""`python -m kinebench_drake` is the program `kinebench-drake`."""

from kinebench_drake.cli import main

if __name__ == "__main__":
    main()
