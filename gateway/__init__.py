"""The robot gateway: reads every robot controller of a cell and serves one honest stream.

Nothing is exported here: start with `gateway.api` to write a vendor, with `gateway.client` to read the stream.
"""

__version__ = "0.1.0"
