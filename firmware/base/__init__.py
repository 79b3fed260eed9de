"""What every other folder uses: errors, axes, settings, the state record, single precision."""
