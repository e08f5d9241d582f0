"""What every room uses: errors, stored files, versions, progress, processes, pages."""
