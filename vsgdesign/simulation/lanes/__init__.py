"""Many runs side by side in one compiled loop: cases as arrays, the sample as plain functions, run and verdicts."""
