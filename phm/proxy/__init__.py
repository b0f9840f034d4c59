"""The rules of a proxy between PHM and the Docker Engine: exactly the calls that a configuration needs."""
