"""Every fault that we can make, against a real gateway: short in `make check`, long by `make soak MINUTES=60`."""
