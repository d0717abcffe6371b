"""Campaigns: flights of many control points, their fits and findings, the tables that follow, the paper's figures."""
