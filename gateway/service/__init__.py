"""The gateway as a service of systemd: its files, and the steps that install and remove it."""
