"""Messages from the network: how many are admitted, and what is believed of them."""
