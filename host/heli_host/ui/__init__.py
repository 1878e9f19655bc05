"""What people see and type: command line, dashboard, Foxglove."""
