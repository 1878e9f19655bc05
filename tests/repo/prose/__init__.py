"""Checks of what people read: words, sentences, paragraphs, numbers and abbreviations."""
