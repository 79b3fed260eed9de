"""What all chips have alike: pins that are not steps, links, flash, the supervisor."""
