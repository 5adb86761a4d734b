"""What a user's problem and filter answer, held to the contracts once, before any work: every slip is one line."""
