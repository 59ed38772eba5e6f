"""Reproduction of chen2022, Section IV: README.md in this folder and `python -m papers.chen2022 --help`."""
