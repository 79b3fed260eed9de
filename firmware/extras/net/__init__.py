"""Network settings and access of extras: `$NET`."""
