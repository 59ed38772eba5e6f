"""Reproduction of liu2020, Section VI: README.md in this folder and `python -m papers.liu2020 --help`."""
