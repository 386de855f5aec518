"""The project's laboratory: it measures gelstereo, and is no part of the package.

`frontier` measures every method's error and time, `experiments` carries out the paper's experiments on the simulated
sensor, and `reports` writes the pages on real data. `pip install ./bench` in a clone adds it to the command
`gelstereo`.
"""
