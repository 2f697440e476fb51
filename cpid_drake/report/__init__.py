"""What people read: tables, figures and rendered pictures of studies."""
