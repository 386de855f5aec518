"""Benchmarks of gelstereo; not part of the package.

`frontier` measures every method's error and time, `experiments` repeats the paper's experiments on the
simulated sensor, and `reports` writes the pages on real data. In a clone, `pip install ./bench` adds them to
the command `gelstereo`.
"""
