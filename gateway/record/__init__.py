"""The flight recorder: what every robot said lately, MCAP files of it, and their replay through the decoders."""
