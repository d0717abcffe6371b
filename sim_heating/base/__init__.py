"""Foundations of all folders: errors, files, progress, batches of jobs, parameters, kernels, pages and figures."""
