"""The clause matrix as a page and as a PDF: verdicts, identity of the model, evidence, survival maps."""
