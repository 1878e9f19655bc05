"""Grades of control laws that fly on the same rigs, marks of submissions, and editions of the course."""
