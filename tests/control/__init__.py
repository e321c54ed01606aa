"""Control: commands, leases, arming, watchdog."""
