"""The worked examples of docs/examples.md, trained on real sets as they are printed."""
