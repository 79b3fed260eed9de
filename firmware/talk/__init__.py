"""Conversation with the sender: lines, commands, reports, and the main loop."""
