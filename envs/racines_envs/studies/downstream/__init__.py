"""Whether a generator's rank means anything: what an agent learns in its images."""
