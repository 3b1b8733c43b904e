"""The configuration file: found, read, checked as a whole, and resolved into plain records for the core."""

from gateway.config.file import Config, find_config, load, parse

__all__ = ["Config", "find_config", "load", "parse"]
