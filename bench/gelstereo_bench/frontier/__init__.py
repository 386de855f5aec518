"""What accuracy costs: every rung of every ladder on fixed simulated scenes, beside a plain OpenCV baseline."""
