"""What an identification, or a comparison with a measured run, writes: files, reports, summaries for the terminal."""
