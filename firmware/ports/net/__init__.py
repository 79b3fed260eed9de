"""Wi-Fi: senders, the page, and who of them is in control."""
