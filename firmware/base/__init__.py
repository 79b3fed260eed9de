"""What all others stand on: errors, axes, settings, the state record, single precision."""
