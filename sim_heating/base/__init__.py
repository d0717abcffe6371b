"""What all folders use: errors, files, progress, batches of jobs, parameters, kernels, pages and figures."""
