"""What is connected: the dynamic check and, beside it, the static one."""
