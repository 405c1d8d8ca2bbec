"""The environment of the program: checks, repairs and native libraries."""
