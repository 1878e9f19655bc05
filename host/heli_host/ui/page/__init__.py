"""The live page: a server that shows a flight in browsers, and takes commands from one of them."""
