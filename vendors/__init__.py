"""The vendors: one folder a brand. The daemon finds them by name; nothing imports them from here."""
