"""The proofs of the flight code: each holds, each can fail, and the document lists them."""
