"""Choice of settings for a sensor, a part and a computer: what accuracy costs in time."""
