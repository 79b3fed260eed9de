"""What senders are told and may set of the network."""
