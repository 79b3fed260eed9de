"""What a sender says and hears: lines, commands, reports, and the loop that answers."""
