"""The doors: one listener, many clients, several protocols. Doors only read."""
