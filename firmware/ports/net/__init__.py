"""Wi-Fi: senders, the page, and which client controls the machine."""
