"""What ``import vsgdesign as vd`` offers: a study in, results with pictures out. Thin calls of the other rooms."""
