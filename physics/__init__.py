"""What a machine obeys: simulators, mechanisms, integration, the compressor."""
