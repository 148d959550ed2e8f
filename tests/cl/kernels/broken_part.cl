int part(int x)
{
    int unused;
    return x + no_such_name;
}
