"""One judgement and one wording for the log, the status, the page and /diagnostics."""
