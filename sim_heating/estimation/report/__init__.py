"""Estimates as files, tables, figures and pages."""
