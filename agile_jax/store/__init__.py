"""What is kept on disk: parts of work, run directories, and what each depends on."""
