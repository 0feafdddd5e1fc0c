"""The gripper on an arm with six joints and a camera beside it: MuJoCo moves it, our ray caster sees."""
