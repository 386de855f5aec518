"""Generated pages of the manual: each command fills the part between its page's comment markers."""
