"""What must hold to the last bit, whatever code a CPU's libraries choose."""
