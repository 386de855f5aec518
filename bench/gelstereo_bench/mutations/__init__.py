"""Whether the tests find faults: each is built into a scratch copy, switched on alone, and the tests run."""
