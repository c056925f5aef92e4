"""The program as a process: system calls of Linux and Windows, supervised threads, libraries of the extras."""
