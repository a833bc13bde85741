from .policy import OnnxPolicyAgent as OnnxPolicyAgent

__all__ = ["OnnxPolicyAgent"]
