"""Everything that runs: finding vendors, keeping links alive, and the bus. Takes plain records, never the config file."""
