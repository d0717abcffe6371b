"""Foundations of all folders: errors, files, progress, work in parallel, parameters, kernels, pages and figures."""
