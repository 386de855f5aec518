"""USB devices made in user space, plugged into the kernel's virtual host controller (vhci_hcd) by USB/IP."""
