"""Reproductions of the papers whose methods the package holds, one folder per paper."""
