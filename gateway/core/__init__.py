"""Everything that runs: finding vendors, keeping links alive, the bus. Takes plain records, never the config file."""
