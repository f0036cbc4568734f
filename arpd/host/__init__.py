"""The host: link interface, radio, addresses and memory."""
