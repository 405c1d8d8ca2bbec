"""Scripted experts planned with Drake."""
