"""The live page of a running graph: contents, access rules and web server. It sees the graph only through ``Graph``."""
