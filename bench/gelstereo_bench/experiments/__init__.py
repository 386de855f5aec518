"""The paper's experiments on the simulated sensor: trials in batches, and one offline report each."""
