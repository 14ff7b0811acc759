"""The commands `doughdata` and `doughnet`, one file a command."""
