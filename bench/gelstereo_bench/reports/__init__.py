"""Pages of the manual that are measured, not written: each command fills the part between its page's markers."""
