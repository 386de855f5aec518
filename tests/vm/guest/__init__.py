"""What runs inside the VM: devices made in user space, and the checks of the host's programs against the
kernel.
"""
