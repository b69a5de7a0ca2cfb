"""The paper's simulation study run again, one file a question; ``study`` puts the answers together."""
