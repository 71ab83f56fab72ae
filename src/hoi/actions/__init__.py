"""What the person does: the action of the most similar known pose [paper 3.2]."""
