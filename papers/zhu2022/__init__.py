"""Reproduction of zhu2022, Section 4: README.md in this folder and `python -m papers.zhu2022 --help`."""
