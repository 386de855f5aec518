"""The paper's experiments on the simulated sensor: batches of trials, and one report per experiment."""
