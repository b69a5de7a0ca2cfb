"""The live page on a running graph: what it shows, who may write, and the web server; it knows the graph as ``Graph`` only."""
