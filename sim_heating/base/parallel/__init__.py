"""Work beside each other: tasks of workers, copies of this process, threads."""
