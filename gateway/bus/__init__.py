"""One RS485 line: what to send next, when, and what an answer means."""
